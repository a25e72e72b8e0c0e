"""Read and write the files in which characters come and go: glTF 2.0 with VRM, and OBJ."""

#: Millimetres per unit of length, as ``--unit`` names them.
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
