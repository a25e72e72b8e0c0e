"""Batches: finding sources, sweeps, workers that are lost, resuming, tables that stay equal."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from recordings import talking_head

from adaptiveface import cli
from adaptiveface.batch import Batch, WorkerLost, completed, dask_client, expand, find_sources, parse_sweep
from adaptiveface.errors import FileFormatError, ParameterError
from adaptiveface.parameters import Parameters


@pytest.fixture(scope="module")
def takes(tmp_path_factory) -> Path:
    """Two good recordings, a damaged one, and files that are none."""
    folder = tmp_path_factory.mktemp("takes")
    actor = talking_head(folder / "monday" / "take", 3)
    talking_head(folder / "tuesday" / "take", 3)
    actor.save(folder / "actor.npz")
    broken = folder / "broken"
    broken.mkdir()
    (broken / "intrinsic.json").write_text("{}")
    (folder / "notes.txt").write_text("no recording")
    return folder


def good(takes: Path) -> list[str]:
    return [source for source in find_sources(takes) if "broken" not in source]


def rows(path: Path) -> list[dict]:
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


# ---- what there is to do ----


def test_recordings_are_found_at_any_depth(takes):
    assert [Path(source).relative_to(takes).as_posix() for source in find_sources(takes)] == [
        "broken",
        "monday/take",
        "tuesday/take",
    ]
    assert find_sources(takes / "monday" / "take") == [str(takes / "monday" / "take")]


def test_a_list_names_sources_relative_to_itself(takes, tmp_path):
    listed = takes / "list.txt"
    listed.write_bytes(b"\xef\xbb\xbf# Monday\nmonday/take\n\nsynthetic:3\nmonday/take\n")
    assert find_sources(listed) == [str(takes / "monday" / "take"), "synthetic:3"]
    listed.unlink()
    empty = tmp_path / "empty.txt"
    empty.write_text("# nothing\n")
    for path in (empty, tmp_path, tmp_path / "absent"):
        with pytest.raises(FileFormatError, match=str(path)):
            find_sources(path)


def test_a_sweep_makes_every_combination(takes):
    sweep = parse_sweep(["laplacian.w2=0.5,1.5", "adaptive_pca.K=2"])
    jobs = expand(good(takes), Parameters(), sweep)
    assert len(jobs) == 4 and len({job.name for job in jobs}) == 4
    assert {Parameters.from_json(job.parameters).laplacian.w2 for job in jobs} == {0.5, 1.5}
    assert [job.name.split("/")[0] for job in jobs] == ["take", "take", "take-2", "take-2"]


@pytest.mark.parametrize("text", ["w2=1", "laplacian.w2", "laplacian.w2=", "laplacian.w2=1,,2"])
def test_a_sweep_of_another_form_is_refused(text):
    with pytest.raises(ParameterError, match="--sweep"):
        parse_sweep([text])


def test_values_are_judged_before_anything_is_tracked(takes):
    for sweep in ({"laplacian.w9": ["1"]}, {"laplacian.w2": ["many"]}):
        with pytest.raises(ParameterError):
            expand(good(takes), Parameters(), sweep)


# ---- workers ----


def _square_or_die(shared: int, number: int) -> int:
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 3:
        raise ValueError("three")
    return shared + number * number


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_worker_that_is_killed_costs_its_own_call_only():
    answers = dict(completed(_square_or_die, [1, 2, 3, 4], processes=2, shared=(10,)))
    assert answers[1] == 11 and answers[4] == 26
    assert isinstance(answers[2], WorkerLost) and "signal 9" in str(answers[2])
    assert isinstance(answers[3], ValueError)


def _die_once(folder: Path, number: int) -> int:
    mark = folder / "died"
    if number == 0 and not mark.exists():
        mark.touch()
        os._exit(1)
    return number


@pytest.mark.slow
@pytest.mark.parametrize("workers", [2, 1])
def test_a_cluster_does_the_call_of_a_lost_worker_again_even_of_its_only_one(workers, tmp_path):
    pytest.importorskip("distributed")
    client = dask_client(workers=workers)
    try:
        assert dict(completed(_die_once, range(4), client, shared=(tmp_path,))) == {n: n for n in range(4)}
    finally:
        client.close()


# ---- whole batches ----


@pytest.mark.slow
def test_one_broken_recording_never_ends_the_batch_and_finished_ones_are_not_done_again(takes, tmp_path, capsys):
    out = tmp_path / "out"
    call = ["batch", str(takes), "--out", str(out), "--actor", str(takes / "actor.npz"), "--processes", "2"]
    assert cli.main(call) == 1
    text = capsys.readouterr().out
    assert "2 of 3 done, 1 failed" in text and "intrinsic.json" in text
    table = {row["source"]: row for row in rows(out / "recordings.csv")}
    assert sorted(row["status"] for row in table.values()) == ["done", "done", "failed"]
    assert "intrinsic.json" in table[str(takes / "broken")]["reason"]
    frames = rows(out / "frames.csv")
    assert len(frames) == 6 and {row["recording"] for row in frames} == {"take", "take-2"}
    index = (out / "index.html").read_text(encoding="utf-8")
    assert "take/report.html" in index and "intrinsic.json" in index
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("*/result.npz")}
    assert cli.main(call) == 1
    assert {path: path.stat().st_mtime_ns for path in out.glob("*/result.npz")} == stamps
    assert rows(out / "recordings.csv") == list(table.values())
    assert not [*out.rglob("*.part*")]


@pytest.mark.slow
def test_a_batch_that_was_killed_goes_on_and_ends_with_the_tables_of_one_that_was_not(takes, tmp_path):
    options = {"actor": str(takes / "actor.npz"), "report": False}
    jobs = expand(good(takes), Parameters(), {"laplacian.w2": ["0.5", "5"]}, **options)
    whole = Batch(jobs, tmp_path / "whole").run(processes=2)
    listed = takes / "good.txt"
    listed.write_text("\n".join(good(takes)))
    command = [
        sys.executable,
        "-m",
        "adaptiveface",
        "batch",
        str(listed),
        "--out",
        str(tmp_path / "killed"),
        "--no-report",
        "--actor",
        options["actor"],
        "--sweep",
        "laplacian.w2=0.5,5",
        "--processes",
        "1",
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    done = tmp_path / "killed" / "take" / "laplacian.w2=0.5" / "done.json"
    limit = time.monotonic() + 120
    while not done.exists() and process.poll() is None and time.monotonic() < limit:
        time.sleep(0.05)
    process.kill()
    process.wait()
    assert done.exists()
    first = done.stat().st_mtime_ns
    resumed = Batch(jobs, tmp_path / "killed").run(processes=2)
    assert done.stat().st_mtime_ns == first
    listed.unlink()
    times = ("seconds", "ms_median", "ms_p95")
    assert [{k: v for k, v in row.items() if k not in (*times, "fingerprint")} for row in resumed] == [
        {k: v for k, v in row.items() if k not in (*times, "fingerprint")} for row in whole
    ]

    def numbers(folder: Path) -> list[dict]:
        return [{k: v for k, v in row.items() if not k.startswith("ms_")} for row in rows(folder / "frames.csv")]

    assert numbers(tmp_path / "killed") == numbers(tmp_path / "whole")
    swept = {row["laplacian.w2"]: row["adaptive_distance"] for row in rows(tmp_path / "whole" / "recordings.csv")[:2]}
    assert len(set(swept.values())) == 2


def test_other_options_make_another_job(takes):
    source = good(takes)[:1]
    first, again = (expand(source, Parameters())[0] for _ in range(2))
    other = expand(source, Parameters().replace(laplacian__w2=9.0))[0]
    assert first.fingerprint == again.fingerprint != other.fingerprint


def test_parquet_says_what_the_csv_says(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    from adaptiveface.batch.tables import write_tables

    records = [
        {"recording": "a", "frames": 3, "status": "done", "reason": "", "folder": "a"},
        {"recording": "b", "laplacian.w2": "5", "status": "failed", "reason": 'no, "face"', "folder": "b"},
    ]
    for name, header in (("a", "recording,frame,x\na,0,1.5\n"),):
        (tmp_path / name).mkdir()
        (tmp_path / name / "frames.csv").write_text(header)
    write_tables(tmp_path, records)
    table = parquet.read_table(tmp_path / "recordings.parquet").to_pylist()
    assert [row["reason"] for row in table] == ["", 'no, "face"'] and table[0]["frames"] == 3
    assert parquet.read_table(tmp_path / "frames.parquet").to_pylist() == [{"recording": "a", "frame": 0, "x": 1.5}]


def test_a_damaged_record_is_no_finished_job(takes, tmp_path):
    from adaptiveface.batch.work import finished

    job = expand(good(takes)[:1], Parameters())[0]
    (tmp_path / job.name).mkdir()
    done = tmp_path / job.name / "done.json"
    for text in ("", "[]", "{", json.dumps({"fingerprint": "other"})):
        done.write_text(text)
        assert finished(tmp_path, job) is None
    done.write_text(json.dumps({"fingerprint": job.fingerprint, "status": "done"}))
    assert finished(tmp_path, job)


def test_what_a_killed_worker_left_is_removed_when_its_recording_is_done(takes, tmp_path):
    jobs = expand([str(takes / "monday" / "take")], actor=str(takes / "actor.npz"), report=False)
    for name in ("take.part12", "take.parts", "other.part12"):
        (tmp_path / "out" / name).mkdir(parents=True)
    assert [record["status"] for record in Batch(jobs, tmp_path / "out").run(processes=1)] == ["done"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir()) == ["other.part12", "take", "take.parts"]
