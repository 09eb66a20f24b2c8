"""What builds the documentation site and the pages that are generated from the code; see CONTRIBUTING.md."""
