"""The report: results of a benchmark go in; one HTML file, tables and pictures come out."""
