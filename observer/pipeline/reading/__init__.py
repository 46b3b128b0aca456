"""Reading photos once: encoding, targets with their poses, edges of the reflection, bearings of the tube."""
