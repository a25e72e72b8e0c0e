"""What is known about faces before and after meeting one: the statistical model, a person's rig, features on both."""
