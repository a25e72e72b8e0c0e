"""Read glTF 2.0 and VRM files, which need not be trusted, add to them, and write new ones."""
