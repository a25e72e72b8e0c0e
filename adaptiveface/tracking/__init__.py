"""Track a face in real time (sections 4 and 5): the tracker and its stages."""
