"""The pushing-corridor controller of Krivic and Piater."""
