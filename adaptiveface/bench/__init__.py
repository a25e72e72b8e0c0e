"""Measure how long each stage takes, beside the paper's figures (:mod:`.paper`) and peers (:mod:`.peers`)."""


def run_bench(args=None) -> int:
    """Run ``adaptiveface bench``: print the tables and return the exit status."""
    as_json = getattr(args, "json", False)
    if getattr(args, "soak", None):
        from .soak import run_soak

        return run_soak(args.soak, as_json)
    if getattr(args, "live", False):
        from .live import run_live

        return run_live(args.seconds, as_json)
    if getattr(args, "vertices", None):
        from .growth import run_growth

        return run_growth(args.vertices, args.frames)
    if getattr(args, "colour", False):
        from .colour import run_colour

        return run_colour(args.frames)
    from .run import main

    return main(args)


__all__ = ["run_bench"]
