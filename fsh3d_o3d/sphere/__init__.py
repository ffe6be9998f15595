"""sphere"""
