"""Sample motions, made by formula: walking, running, boxing, dancing on a 24-joint skeleton.

They let everything run offline. ``python -m tutorial_lib.data.synthetic --out data_samples`` writes
the files of that folder again, ``--benchmark`` measures how much faster than real time they are made.

    from tutorial_lib.data import synthetic
    motion = synthetic.walking(20, speed=1.3, path=[(0, 0), (0, 5), (4, 8)], seed=1)
"""

from .body import sample_skeleton
from .boxing import boxing
from .dancing import dancing
from .gait import running, walking
from .samples import make_samples

__all__ = ["boxing", "dancing", "make_samples", "running", "sample_skeleton", "walking"]
