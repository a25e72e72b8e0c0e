"""Reading a sensor needs numpy, OpenCV and Pillow alone: vendors' libraries live in environments of their own."""

from __future__ import annotations

import subprocess
import sys

from recordings import talking_head

#: Requirements of the project that such an environment may lack.
ABSENT = ("scipy", "tqdm", "numba", "av", "platformdirs", "mediapipe", "threadpoolctl")
SCRIPT = f"""
import sys
sys.modules.update(dict.fromkeys({ABSENT}))
from adaptiveface.cli import main
sys.exit(main(sys.argv[1:]))
"""


def test_convert_needs_nothing_else(tmp_path):
    talking_head(tmp_path / "take", 2)
    command = [sys.executable, "-c", SCRIPT, "convert", str(tmp_path / "take"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and "2 frames" in done.stdout, done.stderr
