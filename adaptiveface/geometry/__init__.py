"""Cameras, frames and meshes: project and back-project points, measure surfaces, draw them."""
