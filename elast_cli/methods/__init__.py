"""Methods: models, planners and controllers put together."""
