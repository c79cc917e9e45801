"""Encoders other than the variational autoencoder."""
