"""What a recording's states say of mechanics: see docs/physics.md."""
