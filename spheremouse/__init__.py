"""Track a ball with a camera and turn its rotation into mouse motion."""

__version__ = "0.1.0"
