"""gsb-import: what engines made of a model file, compared with what MuJoCo C made of it."""
