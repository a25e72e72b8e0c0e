"""What becomes of a tracked performance: result files, animated characters, curves, video, streams."""
