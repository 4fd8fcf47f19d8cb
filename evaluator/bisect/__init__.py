"""Which release of an engine changed what is recorded: releases in environments of their own, searched by halves."""
