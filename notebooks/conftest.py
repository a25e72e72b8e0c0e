"""``pytest --nbmake notebooks`` runs the short form, and fails on errors in slider callbacks."""

import os

os.environ.setdefault("ADAPTIVEFACE_NOTEBOOK_FAST", "1")
os.environ.setdefault("ADAPTIVEFACE_STRICT", "1")
