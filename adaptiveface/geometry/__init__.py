"""Cameras, frames and meshes: project and back-project points, measure surfaces, draw them, and say what a source is."""
