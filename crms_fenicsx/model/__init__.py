"""What a scene is made of: membranes, cables, friction. Values only."""
