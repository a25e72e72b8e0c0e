"""Check the installation for ``adaptiveface doctor``: what is there, what works, and how to mend the rest."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable

from .finding import FAULT, NOTE, OK, Finding
from .opencv_files import opencv
from .places import caches
from .software import browser, graphics, optional, sensors, versions

#: The checks in the order of the output.
CHECKS: tuple[Callable[[], list[Finding]], ...] = (versions, opencv, optional, sensors, graphics, browser, caches)
_SIGNS = {OK: "  ok  ", NOTE: "  -   ", FAULT: "  !!  "}


def examine() -> list[Finding]:
    """Run every check and return the findings. A check that fails itself is also a finding."""
    found = []
    for check in CHECKS:
        try:
            found += check()
        except Exception as error:  # the doctor must survive what it looks for
            found.append(Finding(check.__name__, check.__name__, FAULT, f"could not be examined ({error})"))
    return found


def report(findings: list[Finding]) -> str:
    """Format the findings for people, by group."""
    lines, group = [], ""
    for finding in findings:
        if finding.group != group:
            group = finding.group
            lines.append(group)
        lines.append(f"{_SIGNS[finding.state]}{finding.name:<22} {finding.text}".rstrip())
        lines += [f"{'':28}-> {finding.fix}"] if finding.fix else []
    faults = sum(finding.state == FAULT for finding in findings)
    lines.append("everything that is needed works" if not faults else f"{faults} to be mended: see the lines with !!")
    return "\n".join(lines)


def run_doctor(as_json: bool = False) -> int:
    """Print the findings, and return 0 if everything that is needed works, else 1."""
    findings = examine()
    print(json.dumps([dataclasses.asdict(f) for f in findings], indent=1) if as_json else report(findings))
    return int(any(finding.state == FAULT for finding in findings))


__all__ = ["CHECKS", "FAULT", "NOTE", "OK", "Finding", "examine", "report", "run_doctor"]
