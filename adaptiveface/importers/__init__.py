"""Read face models that people already have, each as a :class:`FaceModel` on the model's own mesh.

==================  =====================================  =====================================================
model               file                                   expressions
==================  =====================================  =====================================================
ICT-FaceKit         folder of OBJ files                    ARKit-named units, generic mixtures as in our own model
Basel 2017, 2019    .h5                                    principal components, each as a + and a - expression
FLAME               .npz (a .pkl is refused)               principal components, and jawOpen from its jaw joint
GNM Head            gnm_head.npz                           principal components per face region
==================  =====================================  =====================================================

None of these models comes with the package. Their own licences apply.
"""

from .basel import load_basel
from .dispatch import import_face_model
from .flame import load_flame
from .gnm import load_gnm
from .ict import load_ict_facekit

__all__ = ["import_face_model", "load_basel", "load_flame", "load_gnm", "load_ict_facekit"]
