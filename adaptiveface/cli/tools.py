"""Commands around the method: ``bench``, ``lab``, ``exercises`` and ``doctor``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .arguments import several, whole


def add_bench(commands) -> None:
    """``bench``."""
    bench = commands.add_parser("bench", help="the per-stage timing table, with its peers where they are installed")
    bench.add_argument("--frames", type=whole(10, 10_000), metavar="N", help="synthetic frames to time")
    sizes = {"type": several(500, 27_000), "metavar": "N,N,N"}
    bench.add_argument("--vertices", **sizes, help="instead: growth of every stage with the mesh, K, S and A, and its peers'")
    bench.add_argument("--live", action="store_true", help="instead: latency and lost frames of the live chain")
    bench.add_argument("--seconds", type=whole(1, 86_400), default=60, metavar="N", help="of --live: %(default)s")
    bench.add_argument("--soak", type=whole(1, 10_000), metavar="MINUTES", help="instead: does the live chain grow?")
    bench.add_argument("--json", action="store_true", help="of --live and --soak: one line of JSON")
    bench.set_defaults(run=run_bench)


def run_bench(args: argparse.Namespace) -> int:
    """``bench``: time every stage on a synthetic performance, beside the paper's figures and other libraries."""
    from ..bench import run_bench as run

    return run(args)


def add_lab(commands) -> None:
    """``lab``."""
    lab = commands.add_parser("lab", help="JupyterLab on a copy of the notebooks, on this machine only")
    lab.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help="%(default)s")
    lab.add_argument("--port", type=whole(1, 65_535), metavar="N", help="default: 8888, or the next free one")
    lab.add_argument("--no-browser", action="store_true", help="only print the address")
    lab.set_defaults(run=run_lab)


def run_lab(args: argparse.Namespace) -> int:
    """``lab``."""
    from ..lab import open_lab

    return open_lab(args.dir, args.port, not args.no_browser)


def add_exercises(commands) -> None:
    """``exercises``."""
    exercises = commands.add_parser("exercises", help="list the exercises; for teachers: student copy, grades of a class")
    todo = exercises.add_mutually_exclusive_group()
    todo.add_argument("--student", type=Path, metavar="DIR", help="write the notebooks without solutions to a new folder")
    todo.add_argument("--grade", type=Path, metavar="FOLDER", help="grade submissions, one folder or file per student")
    todo.add_argument("--otter", type=Path, metavar="DIR", help="write test files for otter-grader")
    todo.add_argument("--mistakes", action="store_true", help="print every planted mistake and what the grader says of it")
    exercises.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="of --grade: grades.csv, grades.json, gradescope/ (default: grades beside FOLDER)",
    )
    exercises.set_defaults(run=run_exercises)


def run_exercises(args: argparse.Namespace) -> int:
    """``exercises``."""
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
    """``doctor``."""
    doctor = commands.add_parser("doctor", help="what is installed, what works, and how to mend the rest")
    doctor.add_argument("--json", action="store_true", help="for programs")
    doctor.set_defaults(run=run_doctor)


def run_doctor(args: argparse.Namespace) -> int:
    """``doctor``: 0 when all that is needed works, else 1."""
    from ..doctor import run_doctor as run

    return run(args.json)
