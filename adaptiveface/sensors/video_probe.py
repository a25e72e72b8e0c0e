"""Open a video in a process with limited memory before this process opens it.

Video decoders allocate whatever a file asks for; in that process they get at most :data:`MAX_BYTES`. The process reads
the address from the standard input. Its exit status is 0 for a first picture, 1 for none, and 2 for one that is too large
or if a limit was reached. It imports nothing of the package, so that it starts fast.
"""

import subprocess
import sys

#: Memory that opening and the first picture may take, bytes. A film of 4K takes half of it.
MAX_BYTES = 256 << 20
MAX_PIXELS = 1 << 25


#: Longest that the first picture may take, s.
PATIENCE_SECONDS = 20.0


def too_large(address: str) -> bool:
    """Return whether the first picture of a video takes more memory than any film of a face does, or never comes.

    Parameters
    ----------
    address : str
        The path of a file, or the address of a stream.

    Returns
    -------
    bool
        The answer. It is always False on systems other than Linux, which do not limit the memory of a process.
    """
    if sys.platform != "linux":
        return False
    command, nowhere = [sys.executable, __file__], subprocess.DEVNULL
    try:
        run = subprocess.run(
            command, input=address.encode(), timeout=PATIENCE_SECONDS, stdout=nowhere, stderr=nowhere, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    return run.returncode not in (0, 1)


def main(address: str) -> int:
    """Open a video and read one picture. Returns the exit status."""
    import resource

    import cv2

    with open("/proc/self/statm") as stream:
        used = int(stream.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MAX_BYTES, used + MAX_BYTES))
    try:
        capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
        if not capture.isOpened():
            return 1
        width, height = (capture.get(key) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            return 2
        return 0 if capture.read()[0] else 1
    except (MemoryError, cv2.error):
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.stdin.buffer.read().decode()))
