"""The papers' tables and figures, one command each: ``python -m tutorial_lib reproduce acrnn`` and ``vae-lstm``.

A command trains what is missing, measures everything and writes one JSON file, its result, to be read again:

>>> from tutorial_lib.reproduce import acrnn
>>> result = acrnn.load_result("runs/acrnn/acrnn.json")
>>> acrnn.tables(result)["table 1"]
"""
