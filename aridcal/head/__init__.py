"""The measuring head: a camera and sonars on the end frame that look at calibration squares. The only home of OpenCV."""
