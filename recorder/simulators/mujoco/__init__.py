"""MuJoCo C; and MuJoCo's model and options, for every engine that reads them."""
