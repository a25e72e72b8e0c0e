"""Section 3: capture of the neutral face. Fusion of depth frames, identity fit, shrink-wrap."""
