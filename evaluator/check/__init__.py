"""Everything that is wrong with a file: damage, contradictions, rules that are not met."""
