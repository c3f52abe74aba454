"""Hydra's configuration files. Installed, they are `torchgrasp.conf`; there is no code here."""
