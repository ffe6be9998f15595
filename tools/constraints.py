"""Resolve constraints.txt anew: the newest versions of everything that all extras need, on each supported Python.

Run by ``make constraints``. It asks pip of each Python what it would install (nothing is installed), and writes names
and versions only: where they came from is not in the file.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
HEADER = "# Versions that continuous integration installs with pip --constraint; written by `make constraints`.\n"
OWN_NAME = "fsh3d-o3d"


def find_python(version: str) -> str:
    """Return an interpreter of a version such as ``"3.12"``: on the path, or one of pyenv's.

    Raises:
        FileNotFoundError: There is none.
    """
    pyenv = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
    for candidate in [shutil.which(f"python{version}"), *map(str, reversed(pyenv))]:
        program = "import sys; print('%d.%d' % sys.version_info[:2])"
        if candidate is not None:
            done = subprocess.run([candidate, "-c", program], capture_output=True, text=True, check=False)
            if done.stdout.strip() == version:
                return candidate
    raise FileNotFoundError(f"no Python {version} found on the path or among pyenv's versions: install it first")


def extras() -> list[str]:
    """Return the extras that pyproject.toml names."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    section = text.partition("[project.optional-dependencies]")[2].partition("\n[")[0]
    return re.findall(r"^([a-z]+) = \[", section, flags=re.MULTILINE)


def resolve(version: str) -> dict[str, str]:
    """Return the version of each package, by normalised name, that pip would install on one Python."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([find_python(version), "-m", "venv", folder], check=True)
        report = Path(folder) / "report.json"
        pip = [f"{folder}/bin/python", "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
        subprocess.run([*pip, "--upgrade", "pip"], check=True)  # older ones fetch whole packages to read what they need
        command = [*pip, "--dry-run", "--ignore-installed", "--report", str(report)]
        # For the first release of each Python, which systems may have: some packages need a later one.
        command += ["--python-version", f"{version}.0", "--only-binary", ":all:", "--target", f"{folder}/target"]
        command += [f"{ROOT}[{','.join(extras())}]"]
        subprocess.run(command, check=True)
        found = (entry["metadata"] for entry in json.loads(report.read_text(encoding="utf-8"))["install"])
        versions = {re.sub(r"[-_.]+", "-", entry["name"]).lower(): entry["version"] for entry in found}
    return {name: number for name, number in versions.items() if name != OWN_NAME}


def lines(resolved: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the constraints for what each Python, in ascending order, was resolved to: one line a version and run."""
    pythons = list(resolved)
    result = []
    for name in sorted({name for versions in resolved.values() for name in versions}):
        own = {python: resolved[python][name] for python in pythons if name in resolved[python]}
        if len(set(own.values())) == 1:  # where it is not needed, a constraint does no harm
            result.append(f"{name}=={next(iter(own.values()))}")
            continue
        runs: list[tuple[str, list[str]]] = []
        for python, number in own.items():
            if runs and runs[-1][0] == number and pythons.index(python) == pythons.index(runs[-1][1][-1]) + 1:
                runs[-1][1].append(python)
            else:
                runs.append((number, [python]))
        result += [f"{name}=={number}; {_marker(run, pythons)}" for number, run in runs]
    return result


def _marker(run: Sequence[str], pythons: Sequence[str]) -> str:
    first, last = pythons.index(run[0]), pythons.index(run[-1])
    if first == last:
        return f'python_version == "{run[0]}"'
    bounds = [f'python_version >= "{run[0]}"'] if first else []
    bounds += [f'python_version < "{pythons[last + 1]}"'] if last + 1 < len(pythons) else []
    return " and ".join(bounds)


def main() -> int:
    """Resolve and write."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    resolved = {}
    for version in PYTHONS:
        print(f"asking pip of Python {version}", file=sys.stderr)
        try:
            resolved[version] = resolve(version)
        except (FileNotFoundError, subprocess.CalledProcessError) as error:
            print(f"constraints: {error}; constraints.txt is as it was", file=sys.stderr)
            return 2
    (ROOT / "constraints.txt").write_text(HEADER + "\n".join(lines(resolved)) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
