"""What is drawn into the viewport: the live picture, outlines, captions."""
