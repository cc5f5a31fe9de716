"""Where problems come from: shape collections, graphs, ground truth and noise. fmsync never imports this package."""
