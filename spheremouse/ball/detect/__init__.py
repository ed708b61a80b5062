"""Frame -> Detections: discs on the ball (blobs, discs), ring targets on the frame (rings), look-alikes (static)."""
