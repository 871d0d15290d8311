"""What `physkin doctor` looks at: does this installation work, and what is to be done where it does not?"""
