"""The laws of scenes whose motion is known in closed form, a kind of scene a module."""
