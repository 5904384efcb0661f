"""The artifact store: manifests, recipes, runs, lineage."""
