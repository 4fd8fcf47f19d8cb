"""The laws of scenes whose motion is known in closed form, a scene a module."""
