"""A running instance takes orders and answers questions, on a Unix socket."""
