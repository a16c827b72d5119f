"""The first configuration: its questions, their answers, and the files that follow from them. Nothing here is a UI."""
