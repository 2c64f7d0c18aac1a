"""Files to data: campaign, tables, quantities in SI, repeats and the split."""
