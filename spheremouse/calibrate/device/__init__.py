"""Offline least squares: what photos and a rolling ball tell of camera and device."""
