"""The variational autoencoder of depth windows."""
