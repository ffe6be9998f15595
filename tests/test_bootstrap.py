"""Set-up, on stub machines: what is installed is found however long the list, what is missing is named."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "tools" / "bootstrap.sh"
NEEDED = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
}


class Machine:
    """A folder with the script, and programs that stand before the real ones; its user may not install anything."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "tools").mkdir()
        shutil.copy(SCRIPT, folder / "tools")
        for name in ("pyproject.toml", "constraints.txt"):
            (folder / name).touch()
        self.program("id", "echo 1000")
        self.program("sudo", "exit 1")
        self.program("uname", "echo Linux")
        # Python and pip in one: makes an environment of itself, and installs with success.
        self.program("python3", '[ "$2" != venv ] || { mkdir -p .venv/bin; cp "$0" .venv/bin/python; }')

    def program(self, name: str, body: str) -> None:
        """Put a shell script on the path."""
        path = self.folder / "bin" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)

    def libraries(self, names: list[str]) -> None:
        """Let ldconfig list these, and after them far more than a pipe holds."""
        lines = [f"\t{name} (libc6,x86-64) => /lib/x86_64-linux-gnu/{name}" for name in names]
        lines += [f"\tlibother{number}.so.1 (libc6,x86-64) => /lib/libother{number}.so.1" for number in range(10_000)]
        listing = self.folder / "listing"
        listing.write_text(f"{len(lines)} libs found in cache `/etc/ld.so.cache'\n" + "\n".join(lines) + "\n")
        self.program("ldconfig", f"exec cat '{listing}'")

    def set_up(self) -> subprocess.CompletedProcess[str]:
        """Run the script."""
        shutil.rmtree(self.folder / ".venv", ignore_errors=True)
        environment = {**os.environ, "PATH": f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
        environment.pop("PYTHON", None)
        command = ["bash", str(self.folder / "tools" / SCRIPT.name), "cpu"]
        return subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120, check=False
        )


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_libraries_are_found_every_time_however_long_the_list(machine):
    machine.libraries(list(NEEDED))
    for _ in range(50):
        done = machine.set_up()
        assert done.returncode == 0, done.stderr
        assert "missing" not in done.stderr


@pytest.mark.parametrize("name", NEEDED)
def test_a_missing_library_is_named(machine, name):
    machine.libraries([other for other in NEEDED if other != name])
    done = machine.set_up()
    assert done.returncode == 2
    assert f"apt-get install {NEEDED[name]}\n" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_names_that_only_look_alike_are_not_taken(machine):
    """A dot is a dot, a prefix is not the name, and a folder of the name is not the library."""
    machine.libraries(["libusb-1x0.so.0", "libGL.so.12", "mylibgomp.so.1", "libX11.so.6.4.0", "libX11-xcb.so.6"])
    done = machine.set_up()
    assert done.returncode == 2
    assert done.stderr.endswith(f"apt-get install {' '.join(NEEDED.values())}\n")


def test_without_ldconfig_nothing_is_called_missing(machine):
    machine.program("ldconfig", "exit 127")
    done = machine.set_up()
    assert done.returncode == 0, done.stderr
    assert "there is no ldconfig here" in done.stderr
    assert all(name in done.stderr for name in NEEDED)


def test_other_systems_are_told_what_is_supported(machine):
    machine.program("uname", "echo Darwin")
    done = machine.set_up()
    assert done.returncode == 2
    assert "Linux only, and the system here is Darwin" in done.stderr
    assert len(done.stderr.splitlines()) == 1
