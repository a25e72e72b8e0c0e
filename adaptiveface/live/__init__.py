"""Live capture: guided neutral scan, features and tracking in threads of their own."""
