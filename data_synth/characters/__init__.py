"""How the built-in characters are made; ``build_characters.py`` puts the steps together."""
