"""The measuring head: images and ranges to poses with their uncertainty. The only place for OpenCV."""
