"""The paper's own timings (section 7, "Performance"), one place for the report and the bench."""

from __future__ import annotations

#: Stage of ``STAGE_NAMES`` -> ms per frame on a quad-core of 2012. "Fitting in adaptive space" (9 ms) is the Laplacian
#: deformation (4.2 ms, the same solver as the final one) together with the projection (the rest).
PAPER_MS = {
    "rigid": 3.2,
    "blendshapes": 3.0,
    "laplacian": 4.2,
    "projection": 4.8,
    "final_deformation": 4.2,
    "adaptive_pca": 3.0,
}

#: Sum of the paper's stages, ms.
PAPER_SUM_MS = sum(PAPER_MS.values())
