"""The papers' tables and figures, one command each: ``python -m tutorial_lib reproduce acrnn --data DIR``.

A command trains what is missing, measures everything and writes one JSON file, its result. The results that the lessons
show lie in ``results/`` and are what the commands gave:

>>> from tutorial_lib.reproduce import acrnn
>>> result = acrnn.load_result()
>>> acrnn.tables(result)["table 1"]
"""
