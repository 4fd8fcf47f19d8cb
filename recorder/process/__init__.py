"""The process of a run: started, followed, limited, killed."""
