"""AnyNet: stereo depth that can be stopped at any moment."""
