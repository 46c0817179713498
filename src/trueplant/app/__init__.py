"""The local web application: what the command line does, in a browser. The project file stays the only truth."""
