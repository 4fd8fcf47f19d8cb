"""Rules for recordings: facts, what can be required of them, and versioned sets of requirements as data."""
