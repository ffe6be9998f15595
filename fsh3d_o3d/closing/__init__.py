"""A closed surface of genus 0 for any mesh."""
