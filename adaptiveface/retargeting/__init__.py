"""Drive other faces with a tracked performance (section 6): characters, ARKit weights, correctives."""

#: Built-in characters, made by ``data_synth/build_characters.py`` from the assets of the embedded face model.
BUILT_IN = ("baby", "hag", "ogre")
#: Which coefficients drive the target: those re-solved from the final mesh v4 (section 6), or those of the initial
#: blendshape fit (section 4.2).
COEFFICIENTS = ("resolved", "initial")
#: The same, or ARKit's own shapes re-solved from v4 (:mod:`~adaptiveface.retargeting.arkit_resolve`).
DRIVERS = ("arkit", *COEFFICIENTS)
