"""`spheremouse calibrate`: photos and recordings in, camera.yaml and rig.yaml out, with reports."""
