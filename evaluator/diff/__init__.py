"""Two recordings, or environments of one, held against each other: where they part first, and how fast."""
