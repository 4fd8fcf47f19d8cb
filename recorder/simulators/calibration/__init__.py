"""An instrument, not an engine: a small contact scene whose variability is built in, to check the evaluation with."""
