"""How neural networks make people move: a tutorial library.

A motion is read, represented, learned, generated, looked at; the sub-packages say so:
``motion``, ``representations``, ``data``, ``models``, ``training``, ``generate``, ``metrics``, ``view``.
"""

__version__ = "0.1.0"
