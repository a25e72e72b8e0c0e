"""Timings of the tracker's stages, beside the paper's figures (:mod:`.paper`) and beside peers (:mod:`.peers`)."""


def run_bench(args=None) -> int:
    """``adaptiveface bench``: print the tables; returns the exit status."""
    from .run import main

    return main(args)


__all__ = ["run_bench"]
