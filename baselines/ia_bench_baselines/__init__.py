"""Methods of other papers and other renderers, plugged into ia_bench by entry points as a third party would."""
