"""Treat a depth map as a surface, and align a shape with it: association, point-to-plane step, ICP."""
