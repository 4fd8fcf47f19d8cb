"""Results kept between evaluations, keyed by what they follow from; may be deleted at any time."""
