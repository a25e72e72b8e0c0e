"""A depth map as a surface, and the rigid alignment of a shape with it: surface, association, step, ICP."""
