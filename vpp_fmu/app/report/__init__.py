"""Reports: figures, pages of HTML, and the content of the JSON files beside them."""
