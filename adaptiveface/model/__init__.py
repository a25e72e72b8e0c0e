"""Hold what is known about faces: the statistical model of all heads, the rig of one person, the features on both."""
