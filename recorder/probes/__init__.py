"""What the machine, its memory and its software are, as a recording should know them."""
