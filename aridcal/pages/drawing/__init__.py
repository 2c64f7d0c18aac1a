"""What every page is drawn with: HTML, figures, words, shapes and the 3D scene."""
