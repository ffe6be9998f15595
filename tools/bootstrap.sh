#!/usr/bin/env bash
# Makes .venv with the package and what it needs, and installs the system libraries that Open3D links to where they are missing.
# Usage: tools/bootstrap.sh EXTRAS [PACKAGE...]    for example: tools/bootstrap.sh cpu,dev chromium
# Quick when there is nothing to do. Installs by itself on Debian and Ubuntu; on other Linux it names the libraries to install.
set -euo pipefail
cd "$(dirname "$0")/.."
extras=${1:-cpu}
shift || true

say() { printf '%s\n' "$*" >&2; }
fail() { say "setup: $*"; exit 2; }

install_packages() {
    local become=""
    if [ "$(id -u)" -ne 0 ]; then
        if command -v sudo >/dev/null 2>&1 && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
            become="sudo"
        else
            fail "these system packages are missing and this user may not install them: $*. As root: apt-get install $*"
        fi
    fi
    command -v apt-get >/dev/null 2>&1 || fail "install the equivalents of these Debian packages and run this again: $*"
    say "setup: installing $*"
    $become env DEBIAN_FRONTEND=noninteractive apt-get update -qq
    $become env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null \
        || fail "apt-get could not install: $*"
}

system=$(uname -s)
[ "$system" = Linux ] || fail "this sets up Linux only, and the system here is $system. There is an open3d wheel for macOS and Windows:" \
    "\"pip install '.[cuda]'\" takes it, but the package is not tested there"

# Asked for once and kept: a reader that leaves a pipe at the first match kills ldconfig, which then counts as failed.
libraries=$({ PATH="$PATH:/usr/sbin:/sbin" ldconfig -p; } 2>/dev/null) || libraries=""
library_missing() { [[ $libraries != *[[:space:]]"$1 ("* ]]; }  # the whole name, literally: "libGL.so.1 (libc6,x86-64) => …"

missing=()
if [ -n "$libraries" ]; then
    library_missing libusb-1.0.so.0 && missing+=(libusb-1.0-0)
    library_missing libGL.so.1 && missing+=(libgl1)
    library_missing libgomp.so.1 && missing+=(libgomp1)
    library_missing libX11.so.6 && missing+=(libx11-6)
else
    say "setup: there is no ldconfig here to look for system libraries with;" \
        "Open3D needs libusb-1.0.so.0, libGL.so.1, libgomp.so.1 and libX11.so.6"
fi
for program in "$@"; do
    command -v "$program" >/dev/null 2>&1 || missing+=("$program")
done

python=""
for candidate in "${PYTHON:-}" python3 python3.12 python3.11 python3.10 python3.13; do
    [ -n "$candidate" ] && command -v "$candidate" >/dev/null 2>&1 || continue
    if "$candidate" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || fail "no Python 3.10 to 3.13 found; install one, or name it: PYTHON=/path/to/python make demo"
if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    missing+=("$("$python" -c 'import sys; print(f"python{sys.version_info[0]}.{sys.version_info[1]}-venv")')")
fi
[ ${#missing[@]} -eq 0 ] || install_packages "${missing[@]}"

stamp=".venv/.installed-$extras"
state=$(cat pyproject.toml constraints.txt tools/bootstrap.sh | sha256sum)
if [ -x .venv/bin/python ] && [ "$(cat "$stamp" 2>/dev/null)" = "$state" ]; then
    exit 0
fi
if ! [ -x .venv/bin/python ] || ! .venv/bin/python -c '' 2>/dev/null; then
    rm -rf .venv
    "$python" -m venv .venv
fi
say "setup: installing the package with [$extras] into .venv (a few minutes the first time)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[$extras]" \
    || fail "pip could not install the package; see its message above"
printf '%s' "$state" > "$stamp"
