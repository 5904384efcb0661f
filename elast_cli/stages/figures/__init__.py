"""The paper's figures of the latent space: Figs. 7, 8a and 9, and the paths of App. D.9."""
