"""gsb-fit: options of a simulator fitted to measured tosses, and judged by tosses that the fit did not see."""
