"""Makes the text half of `mini` from all-MiniLM-L6-v2: python training/mini/text.py MODEL_FOLDER OUT_FOLDER.

Every token of the vocabulary and every phrase of the table gets the full model's vector (mean of the last
layer's tokens, in a sentence of the street so that "crane" is a machine), which a linear map takes to
`DIM`. The map begins as the principal axes of all those vectors and is then turned so that words of one
concept of words.toml come together and those of others part (leave-one-out, so that it learns what is
common to synonyms and not the words). What a phrase outside the table gets is the weighted mean of its tokens.
"""
