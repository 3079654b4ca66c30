"""Reports of an identification: verdict, numbers, images, HTML."""
