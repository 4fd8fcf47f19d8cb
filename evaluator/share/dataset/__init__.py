"""A folder of recordings as a data set: described for whoever finds it, and checked by whoever has it."""
