"""Before any test or lesson runs: folders named relative to here stay right inside a notebook's folder."""

import os
import pathlib

if os.environ.get("TUTORIAL_DATA"):
    os.environ["TUTORIAL_DATA"] = str(pathlib.Path(os.environ["TUTORIAL_DATA"]).resolve())
