"""Several hundred damaged files of every format through the command: exit code 0 or 2, one reason, no remains."""

from __future__ import annotations

import os

import pytest

from fsh3d_o3d.cli import main
from tests.files.mutations import mutated_files


@pytest.mark.filterwarnings("ignore::fsh3d_o3d.errors.GeometryReadWarning")  # some are read with a note
def test_damaged_files_end_in_0_or_2(tmp_path, capsys):
    inbox, outbox = tmp_path / "in", tmp_path / "out"
    inbox.mkdir()
    outbox.mkdir()
    codes = []
    for number, file in enumerate(mutated_files(400, seed=7)):
        source = inbox / f"{number}-{file.name}"
        source.write_bytes(file.data)
        target = outbox / "result.ply"
        # Every other one is only described, because a reconstruction takes longer.
        arguments = (
            ["reconstruct", os.fspath(source), os.fspath(target), "--bandwidth", "4", "--resolution", "200"]
            if number % 2
            else ["info", os.fspath(source)]
        )
        code = main(arguments)
        out, err = capsys.readouterr()
        codes.append(code)
        assert code in (0, 2), (file.name, err)
        assert "Traceback" not in err, (file.name, err)
        assert "internal error" not in err, (file.name, err)
        if code == 2:
            assert out == "", file.name
            *warned, reason = err.splitlines()
            assert reason.startswith("fsh3d: error: "), (file.name, err)
            assert all(line.startswith("fsh3d: warning: ") for line in warned), (file.name, err)
            assert not target.exists(), file.name
        remains = {path.name for path in outbox.iterdir()}
        assert remains <= {"result.ply"}, file.name
        target.unlink(missing_ok=True)
    assert codes.count(0) > 20  # mild damage is still a mesh
    assert codes.count(2) > 100
