"""Write the text tables of an evaluation."""

from __future__ import annotations

from .truth import FIRST, PERFORMANCE_NAMES, REPEAT


def evaluation_table(evaluation) -> str:
    """Write one line for each stage of the first performance and of the repeat. Lengths are in mm."""
    regions = list(evaluation.regions)
    lines = [
        "mm                  surface        active   motion error (neutral removed), mean               active pairs",
        f"performance  stage  median  p95    share    {''.join(f'{name:<9}' for name in regions)} normal  tangential",
    ]
    for performance in (FIRST, REPEAT):
        if not evaluation.frames(performance).any():
            continue
        for stage in evaluation.stages:
            row = evaluation.summary(stage, performance)
            errors = "".join(f"{row[name]:<9.3f}" for name in regions)
            lines.append(
                f"{PERFORMANCE_NAMES[performance]:<12} {stage:<6} {row['surface_median']:<7.3f} "
                f"{row['surface_p95']:<6.3f} {row['active_share']:<8.3f} "
                f"{errors} {row['normal']:<7.3f} {row['tangential']:.3f}"
            )
    lost = sum(evaluation.lost.values())
    lines.append(f"{len(evaluation.index)} frames scored, {lost} lost; {_pose(evaluation)}")
    return "\n".join(lines)


def _pose(evaluation) -> str:
    chosen = evaluation.frames(None)
    if not chosen.any():
        return "no performance among them"
    shift, angle = evaluation.pose_shift[chosen], evaluation.pose_angle[chosen]
    return f"pose error {shift.mean():.2f} mm, {angle.mean():.2f} degrees (mean)"
