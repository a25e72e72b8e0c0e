"""Write a tracked performance for other programs: animated characters, curves, video, streams."""
