"""How the embedded face model is made from CC0 MakeHuman assets; run by ``data_synth/build_face_model.py``."""
