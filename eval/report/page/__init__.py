"""What any report needs: document, tables, equations, numbers in words."""
