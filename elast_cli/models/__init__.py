"""The learned parts: encoder φ, dynamics h_f and H_f, transition density ψ, local policy π."""
