"""Files elsewhere, read in parts: through fsspec, from web servers, and how long is waited for them."""
