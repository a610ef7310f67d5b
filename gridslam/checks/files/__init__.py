"""Files that runs, exports and studies leave."""
