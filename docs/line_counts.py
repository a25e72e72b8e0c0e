"""Lines of every package, now and in another version: ``python docs/line_counts.py REVISION``.

Lines of code are those that hold a token other than a comment or a docstring.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "adaptiveface"
_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def code_lines(text: str) -> int:
    """Number of lines of a module that are neither blank, nor comment, nor docstring."""
    lines: set[int] = set()
    before = tokenize.NEWLINE  # a string that begins a statement is a docstring
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE and not (token.type == tokenize.STRING and before in _NO_CODE):
            lines.update(range(token.start[0], token.end[0] + 1))
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            before = token.type
    return len(lines)


def count(modules: dict[str, str]) -> tuple[Counter[str], Counter[str]]:
    """Lines, and lines of code, of every package, from the texts of its modules by their paths."""
    lines, code = Counter[str](), Counter[str]()
    for path, text in modules.items():
        package = path.split("/")[1] if path.count("/") > 1 else "(modules)"
        lines[package] += text.count("\n")
        code[package] += code_lines(text)
    return lines, code


def at_revision(revision: str) -> dict[str, str]:
    """The modules of a revision."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout

    paths = git("ls-tree", "-r", "--name-only", revision, PACKAGE).splitlines()
    return {path: git("show", f"{revision}:{path}") for path in paths if path.endswith(".py")}


def main() -> None:
    """Print the table."""
    now = {path.relative_to(ROOT).as_posix(): path.read_text() for path in (ROOT / PACKAGE).rglob("*.py")}
    tables = [*count(at_revision(sys.argv[1])), *count(now)]
    print("| package | lines before | now | code before | now |\n|---|---|---|---|---|")
    for package in sorted(set().union(*tables)):
        before, code_before, after, code_after = (table[package] for table in tables)
        print(f"| {package} | {before} | {after} | {code_before} | {code_after} |")
    before, code_before, after, code_after = (sum(table.values()) for table in tables)
    print(f"| all | {before} | {after} | {code_before} | {code_after} |")


if __name__ == "__main__":
    main()
