"""What is measured side by side, and on how many frames."""

WARM_UP = 10  # frames: caches, the allocator and the processor's clock settle; said wherever figures are
BLOCK = 30  # frames that each works through before the next one does: a second of video, with its own caches
STEP, DETECT, FILTER, BLOBS, SIMPLE = "step", "detect", "filter", "blobs", "SimpleBlobDetector"
COMPARED = (STEP, DETECT, FILTER, BLOBS, SIMPLE)
SIZES = ((640, 480), (1280, 720), (1920, 1080))  # px, the first is what the others are compared with
MEMORY_FROM = 1000  # steps, until the allocator has what it needs
STEPS = 10_000  # in a row: a hundred of them are slower than the 99th percentile
TRACKED = 0.95  # of the steps; with fewer the times are not those of tracking
