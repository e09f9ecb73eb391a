"""Data: the catalogue of named data sets, the sample motions made by formula, and training windows.

``load("samples/walking")`` gives a list of motions; ``names()`` lists what there is.
"""

from .catalog import entry, fetch, listed, listing, load, load_first, names, where

__all__ = ["entry", "fetch", "listed", "listing", "load", "load_first", "names", "where"]
