"""What training meshes are made of: people, characters, figures, hands, registered meshes, clips."""
