"""Commands around the method: ``bench``, ``lab``, ``exercises`` and ``doctor``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .arguments import add_command, add_notebook_folder, several, whole


def add_bench(commands) -> None:
    """Add the command ``bench``."""
    bench = add_command(commands, "bench")
    bench.add_argument("--frames", type=whole(10, 10_000), metavar="N", help="synthetic frames to time")
    bench.add_argument(
        "--vertices",
        type=several(500, 27_000),
        metavar="N,N,N",
        help="measure instead how the times grow with the mesh, and with K, S and A",
    )
    bench.add_argument("--colour", action="store_true", help="measure instead what pictures cost, without and with dense skin")
    bench.add_argument("--live", action="store_true", help="measure instead latency and lost frames of live tracking")
    bench.add_argument(
        "--seconds", type=whole(1, 86_400), default=60, metavar="N", help="length of --live (default: %(default)s)"
    )
    bench.add_argument(
        "--soak",
        type=whole(1, 10_000),
        metavar="MINUTES",
        help="measure instead whether memory and times grow in live tracking of this length",
    )
    bench.add_argument("--json", action="store_true", help="print the result of --live or --soak as one line of JSON")
    bench.set_defaults(run=run_bench)


def run_bench(args: argparse.Namespace) -> int:
    """Run ``bench``: time every stage on a synthetic performance, beside the paper's figures and other libraries."""
    from ..bench import run_bench as run

    return run(args)


def add_lab(commands) -> None:
    """Add the command ``lab``."""
    lab = add_command(commands, "lab")
    add_notebook_folder(lab)
    lab.add_argument(
        "--port", type=whole(1, 65_535), metavar="N", help="port of the server (default: 8888, or the next free one)"
    )
    lab.add_argument("--no-browser", action="store_true", help="print the address and open no browser")
    lab.set_defaults(run=run_lab)


def run_lab(args: argparse.Namespace) -> int:
    """Run ``lab``."""
    from ..lab import open_lab

    return open_lab(args.dir, args.port, not args.no_browser)


def add_exercises(commands) -> None:
    """Add the command ``exercises``."""
    exercises = add_command(commands, "exercises")
    todo = exercises.add_mutually_exclusive_group()
    todo.add_argument("--student", type=Path, metavar="DIR", help="write the notebooks without solutions to a new folder")
    todo.add_argument("--grade", type=Path, metavar="FOLDER", help="grade submissions, one folder or file per student")
    todo.add_argument("--otter", type=Path, metavar="DIR", help="write test files for otter-grader")
    todo.add_argument("--mistakes", action="store_true", help="print each mistake that the grader knows, and what it says")
    exercises.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder that --grade writes grades.csv, grades.json and gradescope/ to (default: grades beside FOLDER)",
    )
    exercises.set_defaults(run=run_exercises)


def run_exercises(args: argparse.Namespace) -> int:
    """Run ``exercises``."""
    from ..exercises import EXERCISES, classroom

    if args.student:
        from ..lab import packaged_notebooks

        print(f"{args.student}: {len(classroom.student_copy(packaged_notebooks(), args.student))} notebooks")
    elif args.grade:
        marks = classroom.grade_folder(args.grade, EXERCISES, progress=True)
        out = args.out or args.grade.resolve().with_name(f"{args.grade.resolve().name}-grades")
        classroom.write_marks(out, marks)
        for student in dict.fromkeys(mark.student for mark in marks):
            own = [mark for mark in marks if mark.student == student]
            print(f"{student}: {sum(mark.points for mark in own)} of {len(own)}")
        print(f"{out / 'grades.csv'}: {len(marks)} rows")
    elif args.otter:
        print(f"{args.otter}: {len(classroom.write_otter_tests(args.otter, EXERCISES))} test files")
    else:
        for exercise in EXERCISES:
            print(f"{exercise.notebook:<26} {exercise.name:<22} {len(exercise.mistakes)} mistakes known")
            for mistake in exercise.mistakes if args.mistakes else ():
                print(f"  planted: {mistake.words}\n  said:    {'; '.join(exercise.grade(mistake.answer).findings)}")
    return 0


def add_doctor(commands) -> None:
    """Add the command ``doctor``."""
    doctor = add_command(commands, "doctor")
    doctor.add_argument("--json", action="store_true", help="print the findings as JSON")
    doctor.set_defaults(run=run_doctor)


def run_doctor(args: argparse.Namespace) -> int:
    """Run ``doctor``. The exit status is 0 if everything that is needed works, else 1."""
    from ..doctor import run_doctor as run

    return run(args.json)
