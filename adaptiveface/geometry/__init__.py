"""Cameras, frames and meshes: what a picture measures, where a point lies, what a mesh looks like from somewhere."""
