"""Cable-reinforced membrane structures with foldable finite elements on FEniCSx."""
