"""Studies: experiments that a figure in the docs comes from. They are not installed; run them in a clone with
`PYTHONPATH=training:native python -m physkin_studies.ablations` and the like."""
