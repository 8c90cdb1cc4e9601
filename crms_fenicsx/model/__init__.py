"""Values that make up a scene: membranes, cables, bars, friction, loads on the membrane."""
