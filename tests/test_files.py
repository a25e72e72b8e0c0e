"""Writing whole or not at all, and bounded reading of regular files."""

from __future__ import annotations

import errno
import os

import pytest

from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.files import read_bytes, read_text, replacing


def test_a_block_that_ends_well_replaces_the_file(tmp_path):
    target = tmp_path / "film.mp4"
    target.write_bytes(b"old")
    with replacing(target) as temporary:
        assert temporary.suffix == ".mp4" and temporary.parent == tmp_path
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new" and [*tmp_path.iterdir()] == [target]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("no"), OSError(errno.ENOSPC, "full")])
def test_a_block_that_fails_leaves_the_old_file_alone(tmp_path, error):
    target = tmp_path / "film.mp4"
    target.write_bytes(b"old")
    expected = AdaptiveFaceError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected) as caught, replacing(target) as temporary:
        temporary.write_bytes(b"half")
        raise error
    assert target.read_bytes() == b"old" and [*tmp_path.iterdir()] == [target]
    if isinstance(error, OSError):
        assert str(target) in str(caught.value) and "space" in str(caught.value) and "unchanged" in str(caught.value)


def test_a_missing_folder_is_named(tmp_path):
    target = tmp_path / "absent" / "a.csv"
    with pytest.raises(AdaptiveFaceError, match="nothing was written"), replacing(target) as temporary:
        temporary.write_text("x")


def test_only_regular_files_within_the_limit_are_read(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbf" + "größe".encode())
    assert read_text(path, 100) == "größe"
    with pytest.raises(FileFormatError, match="at most 3"):
        read_bytes(path, 3)
    with pytest.raises(FileFormatError, match="no such file"):
        read_bytes(tmp_path / "b.txt", 3)
    with pytest.raises(FileFormatError, match=str(tmp_path)):
        read_bytes(tmp_path, 3)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="not UTF-8"):
        read_text(path, 100)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_pipes_and_devices_are_refused_at_once_through_links_too(tmp_path):
    pipe, link, zero = tmp_path / "pipe", tmp_path / "link", tmp_path / "zero"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    zero.symlink_to("/dev/zero")
    for path in (pipe, link, zero):
        with pytest.raises(FileFormatError, match="not a regular file"):
            read_bytes(path, 1000)
