"""What a number is worth: intervals and permutation floors for the metrics."""
