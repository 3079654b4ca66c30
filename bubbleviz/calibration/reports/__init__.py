"""What an identification says in the end: verdict, numbers, images, HTML."""
