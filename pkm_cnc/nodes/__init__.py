"""The nodes of the graph: each one thin, parameters and topics around one step object."""
