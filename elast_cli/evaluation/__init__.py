"""From episodes to tables, comparisons and requirements. Pure."""
