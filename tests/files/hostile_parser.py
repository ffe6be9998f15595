"""What a reading process may suffer: functions that stand in for the parser, chosen by the file's name."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from fsh3d_o3d.files.formats.source import ReadFile
from fsh3d_o3d.geometry.arrays import PointArrays


def read(path: str) -> ReadFile:
    """Do what the file's name says."""
    match Path(path).stem:
        case "crash":
            ctypes.string_at(0)
        case "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        case "exit":
            os._exit(3)
        case "raise":
            raise RuntimeError("not foreseen")
        case "hang":
            time.sleep(600)
        case "allocate":
            np.ones(2**30)
        case "garble":
            for descriptor in range(3, 16):
                with contextlib.suppress(OSError):
                    os.write(descriptor, b"\xff" * 64)
            time.sleep(600)
        case "print":
            os.write(1, b"noise " * 1000)
            sys.stdout.write("more noise")
            sys.stdout.flush()
        case "large":
            return ReadFile(PointArrays(np.full((200_000, 3), 2.5)))
    return ReadFile(PointArrays(np.array([[float(os.getpid()), 0, 0]])))
