"""Offline evaluation: every metric from recordings alone, with no simulator, no GPU and no accelerator library."""
